"""Numba's internal names that the kernels use, and the versions with which they are tested.

The SIMD type (`simd`), pointers (`pointer`) and compilation (`decorators`) depend on them: with another version the
kernels might not compile, or write to wrong addresses.
"""

# ruff: noqa: E402 - what does not fit is told before something that is not there is imported
import llvmlite
import numba

from replant.errors import UnsupportedDependencyError

#: The oldest and the newest version (major, minor) of each library with which the tests pass.
TESTED = {"numba": ((0, 61), (0, 68)), "llvmlite": ((0, 44), (0, 50))}


def check(installed):
    """Raise `UnsupportedDependencyError` where one of the versions, by library, is not among those tested."""
    for name, version in installed.items():
        (major, oldest), (_, newest) = TESTED[name]
        found = tuple(int(part) if part.isdigit() else -1 for part in version.split(".")[:2])
        if not (major, oldest) <= found <= (major, newest):
            raise UnsupportedDependencyError(
                f"{name} {version} is installed, replant is tested with {major}.{oldest} to {major}.{newest} and uses "
                f"parts of it that change: pip install '{name}>={major}.{oldest},<{major}.{newest + 1}'"
            )


check({"numba": numba.__version__, "llvmlite": llvmlite.__version__})

from llvmlite import ir as ir
from numba import njit as njit
from numba.core import cgutils as cgutils
from numba.core.imputils import impl_ret_borrowed as impl_ret_borrowed
from numba.core.typeconv.castgraph import Conversion as Conversion
