"""Challenges: an effect concealed in recordings, sealed and scored; and the smallest effect that recordings would show."""
