"""Why was it late? The kernel's trace around an outlier, cut into what took the time."""
