"""The structure search and `fit` on step tests, the records that control engineers make most."""
