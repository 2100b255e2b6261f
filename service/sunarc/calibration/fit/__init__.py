"""The robust maximum a posteriori fit with a marginalised discrepancy field."""
