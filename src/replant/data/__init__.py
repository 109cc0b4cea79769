"""The sources of samples: recorded logs and live streams."""
