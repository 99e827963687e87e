"""Parts of the experiment `crf`, and the training of its trees."""
