"""The text's extended-target PHD filter (Paper B) and the point filter of Vo and Ma."""
