"""From a disparity and scans to a map of the floor, as one calibrated camera sees it."""
