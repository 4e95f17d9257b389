"""The closed loop of tiny networks, compiled by numba."""
