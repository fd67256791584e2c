"""Tables of slow data, day by day, and of flights with words: noise that lasts, and effects that last as long."""
