"""The simulated USB: one full-speed port with its transfers, and the host controller behind it."""
