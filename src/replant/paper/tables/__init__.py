"""Tables 1-4 of the article and the figures drawn from them."""
