"""Problems and distributions: the paper's, more to learn from, splits, and yours."""
