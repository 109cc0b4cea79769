"""The default on random plants, inputs and noises that nobody chose, beside an offline fit and the bound."""
