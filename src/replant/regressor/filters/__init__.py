"""The filters: how derivatives become filtered signals, (2).

To add one: its class, a `Filter`, in a file of this folder, its name in `FILTERS` below.  Settings, checkpoints and the
messages about a wrong argument go by that list; everything else asks the filter itself (see `Filter`).
"""

from replant.regressor.filters.refined import RefinedFilter
from replant.regressor.filters.state_variable import DiscreteFilter, Filter, StateVariableFilter

#: Every filter.
FILTERS: tuple[type[Filter], ...] = (StateVariableFilter, RefinedFilter)

__all__ = ["FILTERS", "DiscreteFilter", "Filter", "RefinedFilter", "StateVariableFilter"]
