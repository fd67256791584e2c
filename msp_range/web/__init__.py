"""The web page of a running bridge: a process of its own, fed through the bridge's socket."""
