"""What is to be explained: window means of recordings less what the simulator says for certain."""
