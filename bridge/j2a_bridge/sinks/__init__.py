"""The sinks of this package, one module each; entry points of the group `j2a.sinks` name them."""
