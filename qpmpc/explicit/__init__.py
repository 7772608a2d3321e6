"""The explicit law of a soft QP: critical regions, their enumeration, their search."""
