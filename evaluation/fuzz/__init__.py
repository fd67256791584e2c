"""Made-up and damaged input for the parts that read what others wrote, for as long as one likes."""
