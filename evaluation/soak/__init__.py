"""One bridge for many hours with random faults, and for some minutes in real time on a busy computer: `make soak`."""
