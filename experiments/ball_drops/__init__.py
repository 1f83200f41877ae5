"""Air drag in balls dropped from a bridge: a diagnosis of something that is no gyro, through a user's mechanism file."""
