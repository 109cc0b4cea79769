"""What watches the samples: outliers, interruptions, the residual's colour, the estimate's path."""
