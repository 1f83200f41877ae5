"""Courses behind readings that are rounded or have noise, against the true ones, on units and loggers drawn at random."""
