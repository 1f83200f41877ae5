"""What a simulator is missing: calibrate, detect, locate, name, model, prove on runs held out."""
