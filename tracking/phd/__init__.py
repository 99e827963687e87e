"""The extended-target PHD filter of the reference (Paper B) and the point filter of Vo and Ma."""
