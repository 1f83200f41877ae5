"""What a careful reader is told beside the numbers of a diagnosis."""
