"""The outputs of a session: estimates for controllers and plots, records, notices."""
