"""What the server shows of itself: state, metrics, pictures."""
