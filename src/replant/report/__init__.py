"""Presentation of results: findings, tables, figures, HTML reports and terminal output."""
