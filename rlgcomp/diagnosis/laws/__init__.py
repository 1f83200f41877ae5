"""Laws beyond the catalogue: drivers × memory × form, sifted for the one that explains what no cause does."""
