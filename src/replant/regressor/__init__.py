"""From samples to the regressor: preprocessing, filters and scaling."""
