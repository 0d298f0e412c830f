"""One file per protocol: how a chamber's controller is asked and told."""
