"""Speed and timing of the project against floors, peers and goals measured in the same run."""
