"""What a set of sequences contains: numbers gathered sequence by sequence, and one page of them."""
