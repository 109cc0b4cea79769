"""What all figures of the article share."""
