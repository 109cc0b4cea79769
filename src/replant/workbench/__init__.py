"""The workbench: a local page on which recorded logs are looked at, cut, fitted and compared."""
