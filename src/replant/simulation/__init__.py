"""A model beside a measured output: free run, offset and initial state, fit in percent."""
