"""What becomes of a ping: air, absorption, spreading, directivity, reflection (the report's chapter 2, corrected)."""
