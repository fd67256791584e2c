"""What a sensor reads, given the truth: the sensor model file, and the mixture that samples and scores readings.

`sensor_model` is light and is what the bridge loads; `mixture` brings scipy.
"""
