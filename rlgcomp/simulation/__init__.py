"""Simulation of chamber runs: programmes, thermal plant, readout optics, monitors, and the simulator that joins them."""
