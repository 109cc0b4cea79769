"""How Sphinx builds the site, `make docs`.  Nothing is fetched, neither while it is built nor while it is read."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

import replant

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
#: What programs in executed pages see: its width, and that it is none, which Jupyter's FORCE_COLOR denies.
TERMINAL = {"COLUMNS": "88", "TTY_COMPATIBLE": "0"}
sys.path.insert(0, str(HERE / "_extensions"))


def digest_of_source() -> str:
    """Return a digest of the package's source and of the terminal: what others have printed is executed again."""
    digest = hashlib.sha256(repr(TERMINAL).encode())
    for path in sorted((ROOT / "src" / "replant").rglob("*.py")):
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


project = "replant"
author = "The replant developers"
release = version = replant.__version__

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_design",
    "click_examples",
    "mathml",
    "schema_tables",
    "shell_cells",
]
nitpicky = True
exclude_patterns = ["_extensions", "_templates"]

# --- pages

myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 4
myst_links_external_new_tab = False

nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "out" / "docs" / "executed" / digest_of_source())
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300  # s for one block
os.environ.update(TERMINAL)
PROFILE = ROOT / "out" / "docs" / "ipython" / "profile_default"
PROFILE.mkdir(parents=True, exist_ok=True)
(PROFILE / "ipython_kernel_config.py").write_text('c.IPKernelApp.matplotlib = "inline"\n')  # cells show figures
os.environ["IPYTHONDIR"] = str(PROFILE.parent)

# --- reference

autodoc_typehints = "none"  # the docstrings name the types
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
default_role = "code"
smartquotes = False  # options begin with --

# --- appearance

html_theme = "pydata_sphinx_theme"
html_title = "replant"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_math_renderer = "mathml"
html_sidebars = {"questions": [], "coming-from": []}  # pages without a section
html_theme_options = {
    "logo": {"text": "replant"},
    "navbar_align": "left",
    "header_links_before_dropdown": 8,
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": [],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
