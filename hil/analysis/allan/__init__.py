"""Allan deviation of a rate: what its noise is made of, and how long it is worth averaging."""
