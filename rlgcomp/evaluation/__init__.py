"""Evaluation on runs held out: bias stability, comparison tables, and a folder of models verified and compared."""
