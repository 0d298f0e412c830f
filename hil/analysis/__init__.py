"""After the night: parameters against temperature, Allan deviation, scatter of repeats, and what RD-GC-86-1 published."""
