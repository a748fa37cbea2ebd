"""Files to the types of jaxpoint and back."""
