"""What happened, and why: plain functions from recordings to frozen data."""
