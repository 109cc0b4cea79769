"""What the verdict and the estimate do when a tuned constant is halved or doubled."""
