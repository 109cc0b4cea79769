"""Several inputs: known plants beside maximum likelihood begun at the truth, plants under a controller, random ones."""
