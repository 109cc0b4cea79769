"""The observer: a process of its own that judges the estimate and shows it."""
