"""The filters as a user chooses them, one class a file, registered here; their loops lie in `kernels.filters`.

To add one: its class, a `Filter`, in a file of this folder, its name in `FILTERS` below.  Settings, checkpoints and the
messages about a wrong argument go by that list; everything else asks the filter itself (see `Filter`).
"""

from replant.estimation.filters.refined_filter import RefinedFilter
from replant.estimation.filters.state_variable import DiscreteFilter, Filter, StateVariableFilter

#: Every filter.
FILTERS: tuple[type[Filter], ...] = (StateVariableFilter, RefinedFilter)

__all__ = ["FILTERS", "DiscreteFilter", "Filter", "RefinedFilter", "StateVariableFilter"]
