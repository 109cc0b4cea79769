"""The identified model: what is kept of an identification, its JSON, its responses, its validation."""
