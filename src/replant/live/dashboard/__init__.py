"""The dashboard: a page that shows a running identification in a browser."""
