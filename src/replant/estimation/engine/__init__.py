"""The arrays of the kernels: layout, content, access, and the choice of the step kernel."""
