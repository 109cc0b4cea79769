"""Monitoring of the samples: outliers, interruptions, colour of the residual, path of the estimate."""
