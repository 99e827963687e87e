"""What judges the suite: experiments, the files of their results, and the pages that are written from them."""
