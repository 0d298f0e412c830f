"""After the night: parameters against temperature, Allan deviation, scatter, and what RD-GC-86-1 published."""
