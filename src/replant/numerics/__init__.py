"""Statistics that several stages share: factors of a covariance, projections, autoregression, batch means."""
