"""What every room uses: errors, checks of arguments, names, redirected output."""
