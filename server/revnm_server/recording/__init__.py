"""Run records: MCAP files of what cameras and robots sent, and of what the server made of it; and their replay."""
