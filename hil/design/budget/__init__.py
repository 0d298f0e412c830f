"""What each source of error contributes to each parameter of a sweep."""
