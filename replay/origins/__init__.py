"""Where the values of a failure come from: the plan runs again with notes of its values, and each is followed back."""
