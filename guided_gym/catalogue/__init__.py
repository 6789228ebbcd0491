"""Problems and their distributions: the paper's, others to learn from, their splits, and your own."""
