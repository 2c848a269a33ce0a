"""What advances assemblies in time: a protocol, and one folder an engine."""
