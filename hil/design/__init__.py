"""Before the night: what a sweep can see, what its errors will be, which sequence serves a goal."""
