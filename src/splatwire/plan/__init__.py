"""Planning: where redundancy pays, found by simulated transfers and by what losses do to the picture."""
