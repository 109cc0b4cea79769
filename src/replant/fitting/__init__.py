"""The identified model (`Model`): what is kept of an identification, its JSON, its responses, its validation."""
