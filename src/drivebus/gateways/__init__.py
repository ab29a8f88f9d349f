"""The plant as others see it: REST and WebSocket, each over ``ServiceClient``; they never meet."""
