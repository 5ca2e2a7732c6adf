"""What every room uses: errors, checks of values, names."""
