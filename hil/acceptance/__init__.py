"""What hil asks of a bench before it trusts it for a night; see `hil.acceptance.plugin`."""
