"""Where samples come from: recorded logs, their inspection and conditioning, live streams."""
