"""The bridge on arm64, emulated by qemu: its unit tests there, and the instructions of its start and its flight."""
