"""Opens recordings: any step back, and why a plan failed."""
