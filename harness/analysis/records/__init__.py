"""Records of raw data, one file per measure, named as the measure's file is."""
