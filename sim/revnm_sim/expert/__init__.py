"""The expert: what it plans, and what every trial is measured by."""
