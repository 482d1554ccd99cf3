"""Light of the real scene on the object, of the object on the real planes, and its shadow there."""
