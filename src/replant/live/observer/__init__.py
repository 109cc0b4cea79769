"""The observer: a separate process that judges the estimate and shows it."""
