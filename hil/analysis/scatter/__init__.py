"""What makes repeats scatter: noise, the bias, MU or a warm-up."""
