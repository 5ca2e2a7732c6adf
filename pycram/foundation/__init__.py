"""Foundation of all packages: errors, checks of arguments, names, redirected output."""
