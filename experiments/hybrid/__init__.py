"""Hybrid compensations: known physics found by diagnosis as the mean, an LS-SVM for the rest, held out beside the LS-SVM alone."""
