"""The filters as a user chooses them, one class a file, registered here; their loops lie in `kernels.filters`."""

from replant.estimation.filters.refined_filter import RefinedFilter
from replant.estimation.filters.state_variable import DiscreteFilter, Filter, StateVariableFilter

#: Every filter: settings, checkpoints and messages go by this list, everything else asks the filter itself.
FILTERS: tuple[type[Filter], ...] = (StateVariableFilter, RefinedFilter)

__all__ = ["FILTERS", "DiscreteFilter", "Filter", "RefinedFilter", "StateVariableFilter"]
