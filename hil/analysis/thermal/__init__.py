"""Parameters against temperature: which form predicts a temperature that was left out, and whether that helps."""
