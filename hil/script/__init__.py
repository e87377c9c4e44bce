"""Scripts of users: an axis as one object, whose jobs are those of the verbs."""
