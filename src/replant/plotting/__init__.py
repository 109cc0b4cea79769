"""What a figure is drawn with and a number is written with: diagrams, numbers as text."""
