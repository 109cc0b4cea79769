"""What several tests share: builders of records, references in NumPy, stand-ins of a wire, a browser."""
