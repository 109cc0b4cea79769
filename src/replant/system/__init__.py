"""What the operating system gives and refuses: threads that begin or are refused, refusals in words."""
