"""Where samples come from: recorded logs and live streams."""
