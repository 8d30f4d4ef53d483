"""Black box: all CAN frames and samples of the last seconds before a stop, stored beside the recording."""
