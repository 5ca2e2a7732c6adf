"""What fluents are made of: terms that have values, waiting for them, and the terms that follow a world."""
