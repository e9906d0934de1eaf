"""Model bundles and depth networks of others: what they are made of, where they come from, how they are run."""
