"""Results of verbs as text and as JSON."""
