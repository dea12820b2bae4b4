"""Dark photographs from elsewhere: what their files hold, and the lit or clean pictures of the same views."""
