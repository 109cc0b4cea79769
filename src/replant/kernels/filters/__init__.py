"""The loops of the filters, and their numerics: autoregression, matrix exponential, Routh's test, simulation."""
