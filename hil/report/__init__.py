"""The report: one self-contained HTML file, made from a campaign folder or from a night."""
