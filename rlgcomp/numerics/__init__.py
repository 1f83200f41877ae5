"""Numerics that know no gyro: filters, hysteresis operators, compiled loops, robust statistics, linear algebra."""
