"""A log that others recorded of a unit put down in many poses: read, cut into what was static, made a campaign."""
