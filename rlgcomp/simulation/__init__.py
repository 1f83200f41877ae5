"""Simulation of runs: programmes, thermal plant, monitors, turntables, and the simulator that joins them."""
