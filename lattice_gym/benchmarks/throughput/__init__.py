"""Throughput: cost of a step as worms, features, elements, muscles and rods grow, and the time to the first step."""
