"""Is there anything beyond noise, and where."""
