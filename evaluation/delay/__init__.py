"""Tables of readings that are late or early, with all that a log's clocks do, for msp-lab gap."""
